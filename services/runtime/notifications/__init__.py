"""The outbox of notifications: an event is recorded in the transaction of its cause.

Recipients and texts of events are in `services/domain/notifications`, sending in `services/maintenance/notifications`.
"""
