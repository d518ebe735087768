"""Search in each assembly mode that a problem leaves open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.tasks.protocol import Search, Timer, part

if TYPE_CHECKING:
    from optlink.tasks.results.design import SynthesisResult


def each_mode(
    problem: ProblemFile, search: Search, one: Callable[[ProblemFile, Search], SynthesisResult]
) -> list[SynthesisResult]:
    """Return the results of `one`, the search of an assembly mode, in each mode until one is interrupted, or exact by default.

    Raises
    ------
    InputError
        If every mode is refused.
    """
    variants = possible_modes(problem)
    if variants == [problem]:
        return [one(problem, search)]
    results, refused = list["SynthesisResult"](), list[InputError]()
    for k, variant in enumerate(variants):
        try:
            result = one(variant, replace(search, timer=Timer(), progress=part(search.progress, k, len(variants))))
        except InputError as error:
            refused.append(error)
            continue
        optima = tuple(replace(optimum, assembly=mode_of(variant)) for optimum in result.optima)
        results.append(replace(result, optima=optima))
        if result.interrupted or (search.starts is None and result.exact):
            break
    if not results:
        raise refused[0]
    return results


def possible_modes(problem: ProblemFile) -> list[ProblemFile]:
    """Return the problem with definite assembly modes, one for each combination in which its sections are consistent.

    If there is none, the error of the first combination is raised.
    """
    variants, refused = list[ProblemFile](), list[InputError]()
    for change in problem.model.mechanism.variants(problem.model.linkage):
        try:
            definite = {**problem.located, **change}
            variants.append(problem.override(definite) if definite else problem)
        except InputError as error:
            refused.append(error)
    if not variants:
        raise refused[0]
    return variants


def mode_of(problem: ProblemFile) -> str:
    """Return the assembly modes of a problem in words, such as "left", or "C left of B-D, E forward"."""
    assembly = problem.raw["mechanism"].get("assembly", "left")
    return assembly if isinstance(assembly, str) else ", ".join(f"{joint} {mode}" for joint, mode in assembly.items())
