"""Starting points of a search: batched least squares, the Freudenstein equation, growth of six-bars."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink.synthesis.four_poses: DyadCurves Pairs
    optlink.tasks.exact: exact
    optlink.tasks.first_designs: FirstDesign starts
    optlink.tasks.four_poses: dyad_curves four_bar_of_dyads
    """,
)
