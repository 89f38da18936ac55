"""What 1,000 labelled frames cost: machines by the hour, and a year of what is kept.

**Conventions.** Prices are assumptions, every one a parameter (USD, of the size of public clouds' list prices in 2025);
what is bought for them is measured or simulated.
"""

from dataclasses import dataclass

THOUSAND = 1000.0


@dataclass(frozen=True)
class Prices:
    """By the hour a worker (one core, 4 GB), the database's machine, and all the rest; a GB kept for a month."""

    worker_per_h: float = 0.05
    database_per_h: float = 0.60
    others_per_h: float = 0.40
    kept_gb_month: float = 0.023
    kept_months: float = 12.0


@dataclass(frozen=True)
class Cost:
    """Of 1,000 frames, USD."""

    workers: float
    servers: float
    kept: float

    @property
    def total(self) -> float:
        return self.workers + self.servers + self.kept


def cost_of(frames_per_s: float, workers: int, kept_bytes_per_frame: float, prices: Prices) -> Cost:
    """Of 1,000 frames at this pace. Raises `ValueError` where no frame is labelled."""
    if frames_per_s <= 0:
        raise ValueError(f"{frames_per_s} frames a second cost no finite amount each")
    hours = THOUSAND / frames_per_s / 3600
    kept = kept_bytes_per_frame * THOUSAND / 1e9 * prices.kept_gb_month * prices.kept_months
    servers = hours * (prices.database_per_h + prices.others_per_h)
    return Cost(hours * workers * prices.worker_per_h, servers, kept)
