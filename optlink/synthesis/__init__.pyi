from optlink.synthesis.four_poses import DyadCurves as DyadCurves, Pairs as Pairs
from optlink.tasks.exact import exact as exact
from optlink.tasks.first_designs import FirstDesign as FirstDesign, starts as starts
from optlink.tasks.four_poses import dyad_curves as dyad_curves, four_bar_of_dyads as four_bar_of_dyads
