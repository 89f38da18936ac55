"""The database cost of a job, the throughput of a thousand claiming processes, and the number of workers per database.

`server_log` reads the transactions from PostgreSQL's log, `counting` labels a recording on a real platform, `sharing`
runs many claiming processes at once, `forecast` uses the results of both.
"""
