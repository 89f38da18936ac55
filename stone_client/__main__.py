"""`python -m stone_client` runs the `stone` command of this package, even if PATH contains another `stone`."""

from stone_client.main import main

main()
