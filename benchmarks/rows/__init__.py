"""A database filled as after years of use, to check that every query uses an index.

`filling` lays the rows down inside PostgreSQL, `kinds` says what they are, `asking` lists the questions (through the
API's own routes and the runtime's own functions), `plans` takes down every statement they lead to and has PostgreSQL
explain it.
"""
