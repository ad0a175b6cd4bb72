"""Pictures of force fields, of coding errors and of measurements, and the page of the viewer."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
