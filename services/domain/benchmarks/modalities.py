"""Sensor modalities of a method: sums of C (cameras), L (LiDAR) and R (radar), each a leaderboard track."""

from typing import Literal, get_args

Modality = Literal["C", "L", "R", "C+L", "C+R", "L+R", "C+L+R"]
MODALITIES: tuple[Modality, ...] = get_args(Modality)
