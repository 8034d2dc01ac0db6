"""Learn from robots, too: evolve, try the best in the truth, learn from throws and tracks, go on; writes rounds.json.

.venv/bin/python docs/results/rounds.py            # an hour on a core
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import other_fluids  # noqa: F401 - registers them

import puddle
from pipeline.store.provenance import environment as provenance
from tasks.design import motors_off
from tasks.evolution import Afpo, Trial, evaluate, evolve
from tasks.seeding import generator

N_SEEDS, N_TRIED = 5, 5
SEARCH = Afpo.model_validate({"population_size": 16, "mutation": {"step": 0.2}})
TRAINING = puddle.Training(
    n_iterations=4000, batch_size=512, learning_rate=0.03, warm_up=0.3, decay="cosine", weight_decay=0.03, loss="mse"
)


@dataclass(frozen=True)
class Arm:
    """A truth, and what learns of it from throws."""

    truth: str
    form: str
    design: str  # of the throws
    n_throws: int = 50
    n_steps: int = 200
    depth: float = 9.0
    n_measure: int = 1200
    n_rounds: int = 4
    n_generations: int = 100  # of a round
    tries: bool = True  # whether networks learn again, from the robots that were tried


TRUTHS = (
    *("true_slush", "anisotropic_slush", "flowing_slush"),
    *("point_drag", "mass_carried_along", "layered_slush", "falling_plate", "mujoco_fluid"),
)
LEARNERS = (("wetted", "robots"), ("wetted_mass", "struck"))  # forms and throws
ARMS = (
    Arm("falling_plate", "wetted", "robots"),
    Arm("falling_plate", "wetted", "robots", tries=False),
    Arm("falling_plate", "wetted_mass", "struck"),
    # As many generations in all as the other learners of kicks.yaml have.
    *(Arm(truth, *learner, n_rounds=3, n_generations=33) for truth in TRUTHS for learner in LEARNERS),
    *(Arm("fluid", *learner, depth=4.0, n_measure=600, n_rounds=3, n_generations=20) for learner in LEARNERS),
)


def rounds(arm: Arm, seed: int) -> Iterator[dict[str, Any]]:
    """Yield what the best robot of each round is predicted to travel, and travels, and the best of those tried [m]."""
    simulate = partial(puddle.simulate, n_measure=arm.n_measure)
    throws = puddle.Throws(design=arm.design, n_throws=arm.n_throws, n_steps=arm.n_steps)
    known = [puddle.throw(arm.truth, throws, seed=seed)]
    network = puddle.Architecture(hidden_layers=2, width=48, form=arm.form)
    trial = Trial(partial(generator, seed, "rounds"))
    for number in range(arm.n_rounds):
        world = puddle.ResidualSlush(arm.depth, puddle.learn(known, network=network, training=TRAINING, seed=seed))

        def score(designs: puddle.Designs, world: puddle.ResidualSlush = world) -> Any:
            return evaluate(simulate(designs, world), disagreement_penalty=1.0)

        if number:  # survivors of the round before, as these networks see them
            seen = trial.population._replace(fitness=score(trial.population.designs).fitness)
            trial = replace(trial, population=seen)
        ((population, _),) = evolve(
            [trial], score, first_generation=number * arm.n_generations, n_generations=arm.n_generations, search=SEARCH
        )
        trial = replace(trial, population=population)
        best = population.designs[np.argsort(-population.fitness)[:N_TRIED]]
        true = simulate(best, arm.truth, depth=arm.depth).displacement
        if arm.tries:
            known.append(puddle.record(best, arm.truth, depth=arm.depth, n_measure=arm.n_measure))
        predicted = float(simulate(best[0], world).displacement.mean())
        passive = float(simulate(motors_off(best[0]), arm.truth, depth=arm.depth).displacement[0])
        scores = {"predicted": predicted, "true": float(true[0]), "best_tried": float(true.max()), "passive": passive}
        yield {"seed": seed, "round": number, **{name: round(score, 3) for name, score in scores.items()}}


def main() -> None:
    """Run all arms."""
    arms = []
    for arm in ARMS:
        results = [row for seed in range(1, N_SEEDS + 1) for row in rounds(arm, seed)]
        what = {"truth": arm.truth, "form": arm.form, "throws": arm.design, "tries": arm.tries}
        arms.append({**what, "n_rounds": arm.n_rounds, "n_generations": arm.n_generations, "rounds": results})
        print(arm, *results, sep="\n", flush=True)
    found = {"schema": "puddle.rounds", "version": 1, "made_with": dict(provenance()), "arms": arms}
    text = json.dumps(found, indent=1).replace("\n     ", " ").replace("\n    }", " }")
    (Path(__file__).parent / "rounds.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
