"""Rebuild the file of the built-in body: ``python -m gva_mi.synthetic.body_generator``."""

from gva_mi.synthetic.body_generator.generate import write_body

if __name__ == "__main__":
    write_body()
