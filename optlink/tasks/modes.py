"""The assembly modes that a problem leaves open."""

from optlink.errors import InputError
from optlink.problem.file import ProblemFile


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
