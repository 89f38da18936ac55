"""A database filled as after years of use, to check that every query uses an index.

`bulk_inserts` inserts the rows inside PostgreSQL and `kinds` defines them. `queries` lists the queries (through the
API's own routes and the runtime's own functions); `plans` records all their statements and PostgreSQL's plans.
"""
