"""The controller of a problem file: controlled output, inverse model and gains."""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator

from optlink.clearance.joint import Gap
from optlink.dynamics.machine import Machine
from optlink.problem.base_model import Section
from optlink.problem.quantity import Duration, FixedAngle, Frequency, Number, Quantity, Unusable, check_name, read_fixed, where


class ServoSection(Section):
    """Servo drive that follows a reference angle and speed: second order, with bandwidth and damping ratio."""

    bandwidth: Annotated[Frequency, where(lambda f: f > 0.0, "a servo has a bandwidth", 'Give for example "300 Hz"')]
    """Undamped natural frequency."""
    damping: Annotated[
        Number, where(lambda share: 0.0 < share <= 10.0, "a damping ratio lies above 0 and not above 10", "Give for example 0.7")
    ] = 0.7
    """Damping ratio, above 0 and at most 10."""


def _read_joints(raw: object) -> Any:
    if not isinstance(raw, list | tuple) or not all(isinstance(name, str) for name in raw):
        raise Unusable("expected a list of joints", 'Write known = ["C"]')
    return tuple(raw)


def _read_either(raw: object) -> Quantity:
    """Read a length or an angle."""
    try:
        return read_fixed(raw, "length")
    except Unusable as error:
        try:
            return read_fixed(raw, "angle")
        except Unusable:
            raise error from None


class ControlSection(Section):
    """Correction of the crank motion so that the output moves as it would without clearance.

    The controller is an inverse model of joints with known clearance, a PID on the output's error, or both.
    """

    output: str | None = None
    """Slider (its slide) or body (its angle) whose ideal motion the controller tracks; default: the last slider on the frame,
    else the last body pinned to it."""
    known: Annotated[Any, BeforeValidator(_read_joints)] | None = None
    """Joints whose clearance is included in the inverse model; default: all."""
    regularisation: Annotated[Quantity, BeforeValidator(_read_either)] | None = None
    """Regularisation of the inverse at dead centres: a length for a slider, an angle for a body; default: a tenth of the largest
    travel per radian of the crank."""
    bandwidth: Annotated[Frequency, where(lambda f: f > 0.0, "a bandwidth is positive", 'Give for example "200 Hz"')] | None = (
        None
    )
    """Highest frequency that the inverse model corrects; default: half of the servo's bandwidth."""
    sample_time: Annotated[
        Duration,
        where(lambda t: t >= 1e-6, "a controller samples at intervals, of a microsecond at least", 'Give for example "0.25 ms"'),
    ] = Quantity(2.5e-4, "time", "s")
    """Sample time of the PID, rounded to the nearest value that divides the revolution and fits its rows."""
    proportional: Number = 0.0
    """Proportional gain of the PID on the output error, referred to the crank [-]."""
    integral: Number = 0.0
    """Integral gain of the PID [1/s]."""
    derivative: Number = 0.0
    """Derivative gain of the PID [s]."""
    limit: Annotated[
        FixedAngle,
        where(lambda angle: angle > 0.0, "the correction limit of the PID is not positive", 'Give for example "5 deg"'),
    ] = Quantity(0.08726646259971647, "angle", "deg")
    """Largest crank angle correction of the PID."""

    def check(self, machine: Machine, gaps: Sequence[Gap]) -> None:
        """Check that the controller fits the machine and its joints with clearance.

        Raises
        ------
        Unusable
            with the key below the controller.
        """
        from optlink.clearance.output import default_output, outputs

        available, points = outputs(machine), [gap.point for gap in gaps]
        if self.output is not None:
            check_name(self.output, available, "no such slider or body", "output")
        for point in self.known or ():
            check_name(point, points, "the joint has no clearance", "known")
        regularisation = self.regularisation
        if regularisation is not None:
            output = default_output(machine) if self.output is None else available[self.output]
            needed, example = ("a length", '"5 mm"') if output.guide else ("an angle", '"5 deg"')
            if (regularisation.kind == "length") != bool(output.guide):
                message = f"{output.name} moves by {needed} per radian"
                raise Unusable(message, f"Give {needed}: {example}", "regularisation", str(regularisation))
            if not regularisation.value > 0.0:
                message = "without regularisation the inverse has no solution at a dead centre"
                raise Unusable(message, f"Give for example {example}", "regularisation", str(regularisation))
