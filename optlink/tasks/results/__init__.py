"""Results of the tasks, as data and JSON."""
