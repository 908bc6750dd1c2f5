"""Rebuild the file of the built-in body: ``python -m gva_mi.sculptor``."""

from gva_mi.sculptor.generate import write_body

if __name__ == "__main__":
    write_body()
