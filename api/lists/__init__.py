"""Lists as bytes: rows of one statement, written without an object per row."""
