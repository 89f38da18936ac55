"""New names of renamed codes, for logs and scripts that contain the old names."""

from collections.abc import Mapping

RENAMED: Mapping[str, str] = {
    "board_moved": "leaderboard_changed",
    "captain_stays": "captain_cannot_leave",
    "database_away": "database_unavailable",
    "exhausted": "scorings_exhausted",
    "foreign_truth": "ground_truth_of_other_phase",
    "inputs_stand": "inputs_complete",
    "provider_away": "provider_unavailable",
    "ranges_away": "ranges_unavailable",
    "root_away": "root_unavailable",
    "shut_out": "account_deactivated",
    "store_away": "store_unavailable",
    "too_many_slabs": "too_many_small_requests",
}
