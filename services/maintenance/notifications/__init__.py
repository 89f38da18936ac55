"""Sends notifications: the sweeper's own queue `notify`, in which each job tries one delivery once.

Start with `delivery` (a job), then `webhook` and `email_message` (the two channels), `checked_connection` (the only
path of a webhook's requests). Delivery is at least once: if the process dies after the receiver answered, the delivery
is sent again with the same id, by which the receiver drops the duplicate.
"""
