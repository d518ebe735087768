"""Integration of a machine with joint clearance by the compiled engine, with the interface of `Integration`."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from optlink.clearance.compiled import motion
from optlink.clearance.compiled.machine import code_of, engine
from optlink.clearance.equations import ReferenceSignal
from optlink.clearance.integration import BUSY, DEEPEST, Block, Impact, Integration, Stalled
from optlink.clearance.joint import SLOWEST

ROWS = 4096
"""Most rows of a call."""

STEPS = 10_000
"""Most steps of a call, after which a keyboard interrupt is noticed: about a tenth of a second."""

EVENTS = 512
"""Most switches of a call."""


@dataclass
class CompiledIntegration(Integration):
    """A motion during its integration by the compiled engine; parameters as those of `Integration`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        equations, gaps = self.equations, len(self.equations.gaps)
        code = code_of(equations)
        self._advance = engine().advance
        reference = equations.drive.reference
        if equations.drive.servo is None or reference is None:
            reference = ReferenceSignal(0.0, 0.0)
        series = np.column_stack([reference.harmonics.real, reference.harmonics.imag])
        self._model = (*code.addresses, code.constants, np.array([reference.start, reference.speed]), series)
        self._limits = np.array([DEEPEST * gap.radius for gap in equations.gaps])
        self._clock, self._contact, self._peaks = np.zeros(4), np.zeros(gaps), np.zeros(2 * gaps + 1)
        self._gained = np.zeros(len(equations.losses))  # works since the last restart: the error of works is relative to them
        self._before = self.works.copy()
        self._space = motion.workspace(2 * equations.size, 2 * equations.size + len(equations.losses), gaps)
        self._call(0)  # compiles the engine, the first time

    def restart(self) -> None:
        """Forget the step size, so that the continuation depends on the state alone."""
        self._clock[motion.TRIAL] = 0.0
        self._before, self._gained = self.works.copy(), np.zeros_like(self._gained)
        self._contact[:] = 0.0
        for gap, impact in self.open.items():
            self._contact[gap] = impact.penetration

    def advance(self, rows: int) -> Iterator[Block]:
        """Integrate a number of rows; yields them in blocks.

        Raises
        ------
        Stalled
            The integration cannot continue.
        """
        reasons = {
            motion.STUCK: "the integrator cannot continue",
            motion.INFINITE: "the motion is no longer finite",
            motion.DEEP: "the penetration of the journal is too large",
            motion.BUSY: f"more than {BUSY} contacts begin and end within {self.step:.3g} s",
        }
        while rows:
            block, status = self._call(min(rows, ROWS))
            rows -= len(block.time)
            if len(block.time):
                yield block
            if self.stop():
                raise KeyboardInterrupt
            if status == motion.DEEP:
                self._check()  # names the joint
            if status in reasons:
                raise Stalled(reasons[status])

    def _call(self, rows: int) -> tuple[Block, int]:
        n, k, parameters = 2 * self.equations.size, len(self.equations.gaps), self._space[-1]
        y = np.concatenate([self.state, self._gained])
        out, contacts, events = np.empty((rows, len(y))), np.empty((rows, 2 * k)), np.empty((EVENTS, 6))
        parameters[0], parameters[4 : 4 + k], parameters[4 + k :] = self.further, self.entered, self.modes
        self._clock[motion.AHEAD] = self.ahead
        status, done, written = self._advance(
            self._model, self.equations.closing, n, self.row, self.step, self.tolerance,
            self.equations.tree.driven, self._limits, STEPS, BUSY, SLOWEST,
            y, self._clock, self._contact, self._peaks, self._space, out, contacts, events,
        )  # fmt: skip
        times = (self.row + np.arange(1.0, done + 1.0)) * self.step
        block = Block(times, out[:done, :n], contacts[:done, k:], contacts[:done, :k], self._before + out[:done, n:])
        self.row, self.ahead = self.row + done, float(self._clock[motion.AHEAD])
        self.state, self._gained = y[:n].copy(), y[n:].copy()
        self.works = self._before + self._gained
        self.entered, self.modes = parameters[4 : 4 + k].copy(), parameters[4 + k :].copy()
        for gap, begins, *figures in events[:written].tolist():
            self._record(int(gap), begins > 0.0, *figures)
        return block, int(status)

    def take_peaks(self) -> tuple[float, ...]:
        """Return the maxima since the last call: penetrations [m] and normal forces [N] of all gaps, torque [N m]."""
        self.open = {impact.gap: impact for impact in self.lasting}
        values = tuple(self._peaks.tolist())
        self._peaks[:] = 0.0
        return values

    @property
    def lasting(self) -> tuple[Impact, ...]:
        """The contacts that have not ended."""
        return tuple(impact.deepened(float(self._contact[gap])) for gap, impact in self.open.items())
