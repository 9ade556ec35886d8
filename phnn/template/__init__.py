"""A first manifest for a folder of recordings whose layout nobody has described yet."""

from phnn.template.draft import template, write_template

__all__ = ["template", "write_template"]
