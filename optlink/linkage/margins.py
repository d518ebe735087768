"""Default limits of the distance from singular positions, where a mechanism locks or may change its branch.

They are the defaults of limits in the problem file, for output laws, paths, poses and cycles alike; a user may set other values
above zero. The validator uses the same values but measures them in motion, by independent formulas.

References
----------
ISO 286-1:2010, table 1: grade IT5 allows 15 um at 100 mm, 1.5e-4 of the length.
"""

import math

LEAST_ALIGNMENT = math.radians(1.0)
"""Least angle [rad] of a joint between two bodies from alignment, so a transmission angle from 1 to 179 deg.

Between two links it is their transmission angle, or 180 deg less it; of a link and a slider the angle of the link from the normal
of the slider's line, likewise; of two guides the angle between their lines; of a swinging guide the angle whose sine is its
slide over the crank. At 1 deg a force is passed on 57 times as large, and
lengths that are 1.5e-4 off (grade IT5) bring the joint into alignment: closer, no drawing could be built.
"""

LEAST_LENGTH_MARGIN = 1e-4
"""Least difference of lengths, as a share of the longest link, where equal ones mean a change point or a point of no direction.

It holds for Grashof's sums (longest + shortest link below the other two), and for coupler and crank where the motion starts at
its inner dead centre (the coupler pin would lie on the crank pivot).
"""

SINGULAR_ALIGNMENT = math.radians(0.001)
"""Angle [rad] of a joint from alignment below which a position counts as singular when a given machine is analysed.

It is far above rounding (double precision leaves about 1e-6 deg) and far below what can be built: lengths would have to agree to
1.5e-10 of their size. A loop that fails to close by no more than that counts as closed, in a singular position.
"""

NEAR_ALIGNMENT = math.radians(5.0)
"""Angle [rad] of a joint from alignment below which an analysis reports the position, as forces and accelerations peak there."""

SMALLEST_ALIGNMENT = math.radians(0.1)
"""Least value [rad] that a problem may set for the alignment: below it a solver's accuracy would decide."""

SMALLEST_LENGTH_MARGIN = 1e-5
"""Least value that a problem may set for the length margin."""

FIXED_LIMIT_TOLERANCE = 1e-9
"""Violation [m, rad or 1] above which a limit that no design variable changes counts as violated, far above rounding errors."""
