"""How well refined poses fit: figures, records, reports, ablations, the study."""
