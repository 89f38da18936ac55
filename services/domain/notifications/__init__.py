"""Notifications: recipients, channels and texts of events.

Start with `choices` (events chosen by a user), `addresses`, `audience` (permitted recipients), `messages` (texts),
`spread` (events become deliveries, deliveries become jobs), `phase_clock` (phases open and close).
"""
