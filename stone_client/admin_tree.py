"""The tree of `stone admin`: the nouns of an administrator, each with its verbs."""

from stone_client.lazy_commands import CommandPlace, GroupPlace

PACKAGE = "stone_client.commands.admin"
ADMINISTRATION = "Administration"


def _group(word: str, text: str, **words: str) -> GroupPlace:
    """Return the functions of the module `word` as the commands of a group, by word."""
    commands = (
        CommandPlace(name.replace("_", "-"), "", f"{PACKAGE}.{word}", function) for name, function in words.items()
    )
    return GroupPlace(word, "", text, tuple(commands))


ADMIN = GroupPlace(
    "admin",
    ADMINISTRATION,
    "Manage users, teams, benchmarks, jobs and backups; for administrators.",
    (
        _group(
            "users",
            "List, add, change and delete users.",
            **{"list": "listed", "add": "add", "role": "set_role", "password": "set_password"},
            **{"deactivate": "deactivate", "reactivate": "reactivate", "delete": "delete"},
        ),
        _group("tokens", "List and revoke the tokens of a user.", list="listed", revoke="revoke"),
        _group(
            "teams",
            "List teams, change their captains and members, grant submissions.",
            **{"list": "listed", "captain": "captain", "remove": "remove", "grant": "grant"},
        ),
        _group("benchmarks", "List benchmarks, create and change them from a file.", list="listed", apply="apply_file"),
        _group(
            "phases",
            "Show a phase; create its inputs; read alarms and reported rows.",
            **{"show": "show", "inputs": "inputs", "alarms": "alarms", "dismiss": "dismiss"},
            **{"reported": "reported_rows", "report": "report"},
        ),
        _group("truths", "List and build the ground truths of a phase.", list="listed", build="build"),
        _group(
            "rescores",
            "Score a phase again, compare, and put the result in force.",
            **{"list": "listed", "start": "start", "diff": "diff", "activate": "activate", "abandon": "abandon"},
        ),
        _group("submissions", "Hide submissions from boards, and show them again.", hide="hide", show="show"),
        _group("datasets", "Create the missing inputs of a published version.", inputs="inputs"),
        _group(
            "jobs",
            "List, show, retry and stop the jobs of all users.",
            **{"list": "listed", "show": "show", "retry": "retry", "cancel": "cancel", "terminate": "terminate"},
        ),
        _group(
            "queues",
            "List, pause, drain and resume the queues of jobs.",
            **{"list": "listed", "pause": "pause", "drain": "drain", "resume": "resume"},
        ),
        _group(
            "backup",
            "Back up the platform on this machine, and restore it.",
            **{"to": "take", "list": "listed", "verify": "verify", "prune": "prune", "restore": "restore"},
        ),
        CommandPlace("workers", "", f"{PACKAGE}.workers", "workers"),
        CommandPlace("audit", "", f"{PACKAGE}.audit", "audit"),
    ),
)
