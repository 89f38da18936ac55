"""What this process has used so far, the children it has waited for included."""

import resource

OURS = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)


def used_cpu_s() -> float:
    """Processor time, user and system."""
    used = [resource.getrusage(who) for who in OURS]
    return sum(one.ru_utime + one.ru_stime for one in used)


def peak_bytes() -> int:
    """The most memory that any one of them held."""
    return max(resource.getrusage(who).ru_maxrss for who in OURS) * 1024
