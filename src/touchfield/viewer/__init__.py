"""Pictures of fields, coding errors and measurements, and the page for browsers."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
