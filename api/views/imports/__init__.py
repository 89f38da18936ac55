"""Imports of published datasets as the API shows them, and the class maps that come with them."""
