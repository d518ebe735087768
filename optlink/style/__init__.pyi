from optlink.presentation.style import (
    BODIES as BODIES,
    COUPLER as COUPLER,
    CRANK as CRANK,
    GROUND as GROUND,
    LIMIT as LIMIT,
    MUTED as MUTED,
    RESULT as RESULT,
    ROCKER as ROCKER,
    SHADE as SHADE,
    STYLE as STYLE,
    TARGET as TARGET,
)
