"""A check of our English: the rules of docs/style.md that a machine can apply, over everything that people read.

**Conventions.** `texts` collects the texts of a checkout, `sentences` splits them, `rules` finds the sentences that
break a rule, and `exceptions.toml` lists the sentences that may. `python -m testing.english` prints each hit and exits
with 1 if there is any.
"""
