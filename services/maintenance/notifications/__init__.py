"""Sends notifications: the sweeper's own queue `notify`, whose jobs each try one delivery once.

Read `delivery` (a job), then `webhook` and `email_message` (the two channels), `checked_connection` (where a webhook's
requests go, and nowhere else). At least once: a process that dies after its receiver answered sends again, with the
same id, by which the receiver drops the second.
"""
