"""Pictures of force fields and of what a coder did to them."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
