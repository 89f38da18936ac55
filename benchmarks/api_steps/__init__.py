"""Processor time of the API's requests by kind, and in which step of a request it goes."""
