"""Entry points of the deployed processes: `python -m services.runtime.processes.<role>`.

`prepare` once per release, then `api` and `worker` in any number, beside `services.maintenance.sweeper`; `alive` is the
probe of what has no port. Images, compose file and cluster name these modules and nothing below them.
"""
