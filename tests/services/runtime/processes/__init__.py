"""Tests of the roles of a deployed platform: what each waits for, says and leaves behind."""
