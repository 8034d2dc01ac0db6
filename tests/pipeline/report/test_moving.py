"""The gallery of the page: the robots that stand for a study."""

from dataclasses import replace

import pytest

from pipeline.report.moving import exemplars, gallery


@pytest.fixture
def filmed(study):
    """Two robots in True Slush at 9 m: one evolved with residuals, one without."""
    robots = [robot for robot in study.replays if robot.depth == 9.0 and robot.in_true_slush and robot.film]
    return sorted(robots, key=lambda robot: robot.environment, reverse=True)


def test_designed_throws_stand_for_residuals_where_no_robot_evolved_with_the_papers(filmed):
    learned, plain = filmed
    designed = replace(learned, environment="designed_throws")
    assert exemplars([plain, designed]) == [designed, plain]
    assert exemplars([designed, plain, learned]) == [learned, plain]
    shown = gallery([plain, designed])
    assert shown.index("designed_throws") < shown.index("dry_land") and "with residuals" in shown
    assert "designed_throws" not in gallery([learned, plain, designed])


def test_the_gallery_speaks_of_the_robots_that_it_shows(filmed):
    learned, plain = filmed
    assert "(above)" in gallery([learned, plain])
    alone = gallery([learned])
    assert "the best robot evolved with residuals, in True Slush" in alone and "(above)" not in alone


def test_a_gallery_without_such_robots_says_why(filmed):
    robots = [replace(filmed[0], environment="true_slush")]
    assert "no champion from Residual Slush or Dry Land" in gallery(robots) and exemplars(robots) == robots
