"""A database as it is after years: does every question still find its answer by an index?

`filling` lays the rows down inside PostgreSQL, `kinds` says what they are, `asking` lists the questions (through the
API's own routes and the runtime's own functions), `plans` takes down every statement they lead to and has PostgreSQL
explain it, `claiming` has workers by the hundred take jobs at once.
"""
