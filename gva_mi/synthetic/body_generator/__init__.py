"""Generator of the built-in body, from ``anatomy`` to ``generate``.

``python -m gva_mi.synthetic.body_generator`` rebuilds its file bit by bit.
"""
