from optlink.tasks.exact import exact as exact
from optlink.tasks.first_designs import FirstDesign as FirstDesign, starts as starts
