"""The crank-rocker of 100 and 500 mm by the law of cosines alone, with scans: nothing of the package."""

from __future__ import annotations

import math

CRANK, FRAME = 0.1, 0.5  # m
POINTS, SPAN = 30, math.pi / 2.0
LEAST = math.radians(45.0)  # transmission angle; at most 180 deg less this


def error(coupler: float, rocker: float) -> float:
    """Return the sum of squares of target minus rocker angle [rad^2] from the outer dead centre on."""
    reach = CRANK + coupler
    phi0 = math.acos((reach**2 + FRAME**2 - rocker**2) / (2.0 * reach * FRAME))
    psi0 = math.pi - math.acos((rocker**2 + FRAME**2 - reach**2) / (2.0 * rocker * FRAME))
    total = 0.0
    for k in range(POINTS + 1):
        turned = SPAN * k / POINTS
        diagonal = math.sqrt(CRANK**2 + FRAME**2 - 2.0 * CRANK * FRAME * math.cos(phi0 + turned))
        to_rocker = math.acos((diagonal**2 + rocker**2 - coupler**2) / (2.0 * diagonal * rocker))
        to_crank = math.acos((diagonal**2 + FRAME**2 - CRANK**2) / (2.0 * diagonal * FRAME))
        total += (psi0 + 2.0 / (3.0 * math.pi) * turned**2 - (math.pi - to_rocker - to_crank)) ** 2
    return total


def extreme_cosines(coupler: float, rocker: float) -> tuple[float, float]:
    """Return the cosines of the smallest and the largest transmission angle."""
    near, far = ((coupler**2 + rocker**2 - base**2) / (2.0 * coupler * rocker) for base in (FRAME - CRANK, FRAME + CRANK))
    return near, far


def slacks(coupler: float, rocker: float) -> dict[str, float]:
    """Return by how much each condition of a crank that turns fully is met [m]; none may be negative."""
    return {
        "crank <= coupler": coupler - CRANK,
        "crank <= rocker": rocker - CRANK,
        "crank <= frame": FRAME - CRANK,
        "crank + frame <= coupler + rocker": coupler + rocker - CRANK - FRAME,
        "crank + coupler <= rocker + frame": rocker + FRAME - CRANK - coupler,
        "crank + rocker <= coupler + frame": coupler + FRAME - CRANK - rocker,
    }


def allowed(coupler: float, rocker: float) -> bool:
    """Return whether crank and transmission angle are as required."""
    near, far = extreme_cosines(coupler, rocker)
    return min(slacks(coupler, rocker).values()) >= 0.0 and near <= math.cos(LEAST) and far >= -math.cos(LEAST)


def shortest_pair() -> tuple[float, float]:
    """Return coupler and rocker of least sum [m], the coupler the longer one, by a scan of both in ever finer steps."""
    best, width = (0.5, 0.5), 0.4
    for _ in range(40):
        steps = [width * (k / 12 - 1.0) for k in range(25)]
        pairs = [(best[0] + i, best[1] + j) for i in steps for j in steps]
        best = min((pair for pair in pairs if pair[0] >= pair[1] and allowed(*pair)), key=sum)
        width *= 0.6
    return best


def best_of_ratio(ratio: float) -> tuple[float, float, float]:
    """Return coupler and rocker [m] of that ratio with the least error, and the error, by a scan of the rocker."""
    best, width = 0.25, 0.1
    for _ in range(12):
        rockers = [best + width * (k / 50 - 1.0) for k in range(101)]
        best, width = min((c for c in rockers if allowed(ratio * c, c)), key=lambda c: error(ratio * c, c)), 0.2 * width
    return ratio * best, best, error(ratio * best, best)
