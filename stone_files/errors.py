"""Refusals of outputs."""

from pathlib import Path

from stone_base.errors import Refused


def output_exists(path: Path, obstacle: str) -> Refused:
    return Refused("output_exists", f"{path} is {obstacle}; choose another output path, or remove it first")
