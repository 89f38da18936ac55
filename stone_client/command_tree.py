"""The tree of `stone`: every command and group of the client, and the platform's commands if it is installed.

**Conventions.** A verb at the top works on files of this machine; a noun with verbs below it works on a server. The
words of release 0.1 are in `stone_client/old_words.py`.
"""

from collections.abc import Iterator, Sequence

from stone_client.admin_tree import ADMIN, ADMINISTRATION
from stone_client.lazy_commands import CommandPlace, GroupPlace, Place, places
from stone_client.platform_part import platform_places

PACKAGE = "stone_client.commands"
HERE, SERVER = "On this machine", "With a server"
PANELS = (HERE, SERVER, ADMINISTRATION)


def _at(module: str, **words: str) -> tuple[CommandPlace, ...]:
    """Return the functions of one module as commands, by word."""
    return tuple(CommandPlace(word, "", f"{PACKAGE}.{module}", name) for word, name in words.items())


def _in(group: str, *modules: str) -> tuple[CommandPlace, ...]:
    """Return the commands of a group, each in a module of its own name."""
    return places("", f"{PACKAGE}.{group}", *modules)


SPLITS = GroupPlace(
    "splits",
    "",
    "Show, propose and save the draft splits: train, val and test.",
    _in("dataset.splits", "show", "propose", "put"),
)
GROUPS = (
    GroupPlace(
        "auth",
        SERVER,
        "Sign in to a server, sign out, and show who is signed in.",
        _in("auth", "login", "logout", "status"),
    ),
    GroupPlace(
        "sequence",
        SERVER,
        "Upload recordings, label them on a server, and download labels and exports.",
        (
            *_at("sequence.status", list="listed", status="status"),
            *_in("sequence", "upload", "register", "process", "watch", "cancel"),
            *_in("sequence", "edit", "delete", "download", "exports"),
        ),
    ),
    GroupPlace(
        "label-set",
        SERVER,
        "List, activate, compare and delete the label sets of a sequence.",
        (*_at("label_set.listed", list="listed"), *_in("label_set", "activate", "compare", "delete")),
    ),
    GroupPlace(
        "dataset",
        SERVER,
        "Show, publish, download and import the dataset and its splits.",
        (
            *_at("dataset.versions", list="listed", show="show", download="download"),
            *_in("dataset", "publish", "statistics"),
            SPLITS,
            CommandPlace("import", "", f"{PACKAGE}.dataset.dataset_import", "import_dataset"),
        ),
    ),
    GroupPlace(
        "benchmark",
        SERVER,
        "Take part in benchmarks: inputs, submissions, results and leaderboards.",
        (
            *_at("benchmark.listed", list="listed"),
            *_in("benchmark", "manifest", "inputs", "submit", "results", "leaderboard"),
            *_in("benchmark", "compare", "withdraw", "reported"),
        ),
    ),
    GroupPlace(
        "team",
        SERVER,
        "Create, list and join teams, and invite members.",
        _at("team", list="listed", create="create", invite="invite", join="join"),
    ),
    GroupPlace(
        "notifications",
        SERVER,
        "Choose the events you are notified of by e-mail or webhook.",
        _at("notifications", list="listed", on="on", off="off", deliveries="deliveries"),
    ),
)
OWN: tuple[Place, ...] = (*places(HERE, PACKAGE, "validate", "baseline", "score", "explain"), *GROUPS, ADMIN)
COMMANDS: tuple[Place, ...] = tuple(
    entry for panel in PANELS for entry in (*platform_places(), *OWN) if entry.panel == panel
)


def leaves(listed: Sequence[Place] = COMMANDS, path: tuple[str, ...] = ()) -> Iterator[tuple[str, CommandPlace]]:
    """Yield every command below these places with its words, such as `dataset splits put`."""
    for entry in listed:
        here = (*path, entry.word)
        if isinstance(entry, GroupPlace):
            yield from leaves(entry.places, here)
        else:
            yield " ".join(here), entry
