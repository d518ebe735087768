"""The studio: a page in the browser on which a linkage is optimised again while one of its handles is dragged."""
