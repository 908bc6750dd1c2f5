"""Rebuilds the puppet's file: ``python -m gva_mi.sculptor``."""

from gva_mi.sculptor.sculpt import write_puppet

if __name__ == "__main__":
    write_puppet()
