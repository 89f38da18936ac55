"""Entry points of the deployed processes: `python -m services.runtime.processes.<role>`.

Run `prepare` once per release, then `api` and `worker` in any number, beside `services.maintenance.sweeper`;
`health_check` is the probe of processes without a port. Images, compose file and cluster name only these modules.
"""
