"""Who may do what, cell by cell: callers × operations of the application's own document × whose things they are."""
