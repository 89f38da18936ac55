"""Maintenance: the sweeper and the programs that check and repair the store."""
