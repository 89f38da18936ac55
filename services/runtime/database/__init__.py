"""The database: connections, transactions, and the history of its schema."""
