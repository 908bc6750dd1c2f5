"""Options of a fit: ranges, schedule and record."""

import json
from pathlib import Path

from gva_mi.fit.options import FitOptions, Schedule


def test_a_schedule_counts_in_shares_of_the_run():
    schedule = Schedule(densify_every=100, densify_from=0.1, densify_until=0.3, reinit_at=(0.5,))
    rounds = [k for k in range(1, 1001) if schedule.densifies(k, 1000)]
    assert rounds == [100, 200, 300]
    assert [k for k in range(1, 1001) if schedule.reinitialises(k, 1000)] == [500]


def test_no_round_of_density_control_follows_where_a_reinitialisation_does():
    schedule = Schedule()  # 2,000 steps: rounds are due at 1,000, where the second one falls
    both = [k for k in range(1, 2001) if schedule.densifies(k, 2000)]
    assert both == [200, 400, 600, 800] and schedule.reinitialises(1000, 2000)


def test_options_go_into_a_file(tmp_path):
    options = FitOptions(vgg16=Path("weights.pth"))
    assert json.loads(json.dumps(options.plain()))["vgg16"] == "weights.pth"
    assert FitOptions().plain()["vgg16"] is None
