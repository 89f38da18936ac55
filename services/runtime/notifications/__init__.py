"""The outbox of notifications: events are recorded in the transaction of what they tell of.

Whom an event is told, and in which words, is in `services/domain/notifications`; how it is sent in
`services/maintenance/notifications`.
"""
