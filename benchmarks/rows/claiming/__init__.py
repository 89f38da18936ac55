"""What a job costs the database, what a thousand claiming processes get of one, and how many workers that carries.

`server_log` reads the transactions out of PostgreSQL's log, `counting` labels a recording on a real platform, `sharing`
has many processes claim at once, `forecast` is fed with both.
"""
