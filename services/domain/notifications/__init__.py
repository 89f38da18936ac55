"""Who is told of which event, by which channel, in which words.

Read `choices` (what a user wants), `addresses` (where to), `audience` (who may be told), `messages` (the words),
`spread` (an event becomes deliveries, these become jobs), `phase_clock` (phases open and close).
"""
