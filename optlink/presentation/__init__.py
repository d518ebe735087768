"""Reports: tables, figures, HTML pages and drawings."""
