"""Reports: tables, pictures, pages, drawings."""
