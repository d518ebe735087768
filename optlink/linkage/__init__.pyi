from optlink.linkage import dyads as dyads, fourbar as fourbar
from optlink.linkage.arguments import reachable as reachable, sweep as sweep, travels as travels
from optlink.linkage.fourbar import GrashofClass as GrashofClass, four_bar as four_bar, grashof as grashof
from optlink.linkage.jet import Jet as Jet
from optlink.linkage.mechanism import Mechanism as Mechanism, Pose as Pose
from optlink.linkage.motion import Motion as Motion
from optlink.linkage.roberts import Cognate as Cognate, CouplerLinkage as CouplerLinkage, cognates as cognates
from optlink.linkage.stroke import Travel as Travel
