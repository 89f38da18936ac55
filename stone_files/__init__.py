"""Files as the platform writes them: whole or absent, and archives whose every byte is known beforehand."""
