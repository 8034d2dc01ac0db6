"""Learners: what each takes from the study's groups, and how readers know them."""

from tasks.residual import LEARNERS, LearnerSettings, Throws, arm_kind, in_order
from tasks.residual.learner import learner_of

GROUPS = LearnerSettings(throws=Throws(n_throws=30, max_velocity=5.0))
OWN = {**LEARNERS, "few": LearnerSettings(throws=Throws(n_throws=4)), "mean_of_few": LearnerSettings(mean="few")}


def test_a_learner_takes_what_it_does_not_state_from_the_groups():
    few, mean, designed = (learner_of(name, OWN, GROUPS, 8) for name in ("few", "mean_of_few", "designed_throws"))
    assert few.throws == Throws(n_throws=4, max_velocity=5.0) and (few.data_set, few.n_members) == ("few", 8)
    assert (mean.data_set, mean.use, mean.throws) == ("few", "mean", few.throws) and not mean.is_ensemble
    assert designed.throws == Throws(design="robots", n_throws=3400, n_steps=None)  # whose starts have no ranges


def test_arms_are_listed_and_called_for_readers():
    learners = {name: learner for name in OWN if (learner := learner_of(name, OWN, GROUPS, 8))}
    assert arm_kind("few", learners).label == arm_kind("few").label == "Few"
    assert arm_kind("residual_slush", learners).label == "Residual Slush" and arm_kind("few").learned
    names = ["few", "randomised_slush", "true_slush", "few", "single_member"]
    assert in_order(names) == ["true_slush", "single_member", "few", "randomised_slush"]
