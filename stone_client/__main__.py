"""`python -m stone_client`: the `stone` command, whichever programs of that name are on PATH."""

from stone_client.main import main

main()
