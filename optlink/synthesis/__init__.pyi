from optlink.tasks.first_designs import FirstDesign as FirstDesign, starts as starts
