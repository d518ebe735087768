"""The linear equations of a step along the paths of `homotopy`, one path after another, compiled by numba."""

from typing import Any

import numpy as np
from numba import njit

OPTIONS: Any = {"error_model": "numpy", "cache": True, "nogil": True}


@njit(**OPTIONS)
def solved(dyads, turns, d, e, poses, tangent, to_d, to_e, to_turn, change, turned):
    """Write `homotopy.steps` of all paths to `change` and `turned`; `tangent`: for the rates of the data."""
    count, points = turns.shape
    matrix = np.empty((8, 9), np.complex128)
    slope = np.empty((2, points, 4), np.complex128)
    value = np.empty((2, points), np.complex128)
    by_turn = np.empty((2, points), np.complex128)
    for path in range(count):
        for k in range(2):
            x, xb, u, ub = dyads[path, k]
            for i in range(points):
                t = turns[path, i]
                inverse = 1.0 / (1.0 + t)
                s = -t * inverse
                p, q = d[path, i] + t * x, e[path, i] + s * xb
                by_d, by_e = ub + q, u + p
                slope[k, i, 0] = t * by_d
                slope[k, i, 1] = s * by_e
                slope[k, i, 2] = q
                slope[k, i, 3] = p
                by_turn[k, i] = x * by_d - inverse * inverse * xb * by_e
                if tangent:
                    value[k, i] = by_d * to_d[i] + by_e * to_e[i] + by_turn[k, i] * to_turn[i]
                else:
                    value[k, i] = p * by_d + u * q
        matrix[:] = 0.0
        for i in range(poses):
            for k in range(2):
                row = k * poses + i
                matrix[row, 4 * k : 4 * k + 4] = slope[k, i]
                matrix[row, 8] = -value[k, i]
        for i in range(poses, points):
            size = np.sqrt(by_turn[0, i].real ** 2 + by_turn[0, i].imag ** 2 + by_turn[1, i].real ** 2 + by_turn[1, i].imag ** 2)
            one, other = by_turn[1, i] / size, -by_turn[0, i] / size
            row = poses + i
            for j in range(4):
                matrix[row, j] = one * slope[0, i, j]
                matrix[row, 4 + j] = other * slope[1, i, j]
            matrix[row, 8] = -(one * value[0, i] + other * value[1, i])
        for j in range(8):
            best, most = j, -1.0
            for i in range(j, 8):
                size = abs(matrix[i, j].real) + abs(matrix[i, j].imag)
                if size > most:
                    best, most = i, size
            if best != j:
                for k in range(j, 9):
                    matrix[j, k], matrix[best, k] = matrix[best, k], matrix[j, k]
            pivot = 1.0 / matrix[j, j]
            for i in range(j + 1, 8):
                factor = matrix[i, j] * pivot
                for k in range(j + 1, 9):
                    matrix[i, k] -= factor * matrix[j, k]
            matrix[j, j] = pivot
        for j in range(7, -1, -1):
            total = matrix[j, 8]
            for k in range(j + 1, 8):
                total -= matrix[j, k] * matrix[k, 8]
            matrix[j, 8] = total * matrix[j, j]
            change[path, j // 4, j % 4] = matrix[j, 8]
        for i in range(points):
            if i < poses:
                turned[path, i] = to_turn[i] if tangent else 0.0
                continue
            total, size = 0j, 0.0
            for k in range(2):
                rest = value[k, i]
                for j in range(4):
                    rest += slope[k, i, j] * matrix[4 * k + j, 8]
                total += by_turn[k, i].conjugate() * rest
                size += by_turn[k, i].real ** 2 + by_turn[k, i].imag ** 2
            turned[path, i] = -total / size


def steps(dyads, turns, d, e, poses, rates=None):
    """Return the same as `homotopy.steps`."""
    change, turned = np.empty_like(dyads), np.empty_like(turns)
    solved(dyads, turns, d, e, poses, rates is not None, *(rates or (d[0],) * 3)[:3], change, turned)
    return change, turned
