"""Rooms that a synthetic subject is filmed in, and the film of a phone.

==================  ================================================================
``finishes``        colours of floors, walls and furniture: one formula for all
``furniture``       pieces made of boxes, and plants
``room``            the room around a subject, drawn from a seed
``phone``           the film: noise of the sensor, and compression
==================  ================================================================
"""
