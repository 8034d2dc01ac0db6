"""The sentences of README.md and docs/*.md whose figures or claims follow from results files, by page."""

from collections.abc import Mapping, Sequence

from benchmarks import page_figures as figures
from benchmarks import page_figures_of_throws as of_throws
from benchmarks.page_figures import EQUAL, kept, percent, share
from benchmarks.sentences import Sentence

ROW, SHALLOW, DESK, DESK_REPLICATES = (
    f"docs/results/{name}.json" for name in ("row", "row-shallow", "desk", "desk-replicates")
)
LAPTOP, MAGNITUDES, REPLICATES = (
    f"docs/results/{name}.json" for name in ("laptop", "laptop-magnitudes", "laptop-replicates")
)
CHOICES, ROBOT, INTERVALS, RECORDED = (
    f"docs/results/{name}.json" for name in ("open-choices", "bench-robot", "intervals", "recorded")
)
THROWS, TRACKS, ROLLOUTS, VIDEO = (
    f"docs/results/{name}.json" for name in ("throws", "tracks", "tracks-rollouts", "tank-video")
)
STUDIES, FEW, RULES = (f"docs/results/{name}.json" for name in ("throws-studies", "few-throws", "penalty-rules"))
SENSITIVITY, BENCHMARKS = "docs/sensitivity.json", "benchmarks/results.json"
PROFILE, PONTOON = "docs/results/kernel-profile.json", "docs/results/pontoon.json"


def _recorded(words: str, name: str) -> Sentence:
    """Return a sentence with the figures of a recorded measurement."""
    return Sentence(words, (RECORDED,), lambda recorded: recorded[name]["figures"])


SENTENCES: Mapping[str, Sequence[Sentence]] = {
    "README.md": (
        Sentence(
            "Robots evolved under a single network that learned from the paper's throws are predicted to travel "
            "{predicted} m and travel {true} m; those of the ensemble travel {of_mean} % of μ and {of_fitness} % of "
            "μ − σ. With throws designed for robots they travel {designed} % of μ.",
            (DESK,),
            lambda desk: {
                "predicted": f"{figures.mean(desk, 'single_member', 'predicted'):.0f}",
                "true": f"{figures.mean(desk, 'single_member', 'zero_shot'):.0f}",
                "of_mean": percent(kept(desk, "residual_slush")),
                "of_fitness": percent(kept(desk, "residual_slush", of="fitness")),
                "designed": percent(kept(desk, "designed_throws")),
            },
        ),
        Sentence(
            "At all ten depths the mean of *Ê\\** is ahead of that of *Ê* zero-shot: it retains {designed_low} to "
            "{designed_high} % of *E*, where *Ê* retains {papers_low} to {papers_high} %.",
            (DESK,),
            figures.over_depths,
            figures.always_ahead,
        ),
        Sentence(
            "With 8 networks of 3 × 64 the paper's throws give {zero_shot} % zero-shot and {adapted} % adapted, where "
            "the paper has 67 % and 87 %.",
            (ROW,),
            lambda row: {
                "zero_shot": percent(share(row, "residual_slush")),
                "adapted": percent(share(row, "residual_slush", "adapted")),
            },
        ),
        Sentence(
            "*Ê* retains {zero_shot} % of *E* zero-shot and *Ê\\** {designed} %",
            (LAPTOP,),
            lambda laptop: {
                "zero_shot": percent(share(laptop, "residual_slush")),
                "designed": percent(share(laptop, "designed_throws")),
            },
        ),
        Sentence(
            "`simulate` steps all designs at once, {least} to {most} times as fast as Box2D's own `Step`",
            (BENCHMARKS,),
            lambda benchmarks: {
                name: f"{of(of_throws.medians(benchmarks, 'Step alone over batch')):.0f}"
                for name, of in (("least", min), ("most", max))
            },
        ),
    ),
    "docs/results.md": (
        Sentence(
            "Robots evolved under the ensemble travel as far as its μ − σ; robots evolved under a single network fall "
            "{metres} m short of its prediction.",
            (ROW,),
            lambda row: {"metres": f"{figures.shortfall(row, 'single_member'):.0f}"},
            lambda row: abs(kept(row, "residual_slush") - 1) < EQUAL,
        ),
        Sentence(
            "At every depth robots of designed throws travel farther on average, zero-shot, than those of the paper's "
            "throws: *Ê\\** retains {designed_low} to {designed_high} % of *E*, *Ê* {papers_low} to {papers_high} %. "
            "With two data sets the difference is beyond chance at {n_beyond} of the depths, the deepest of them "
            "{deepest} m (p < 0.05, Welch's t test with the variance between data sets). "
            "Adapted, *Ê\\** retains {adapted_low} to {adapted_high} % of *E* adapted. Robots of "
            "designed throws travel {kept_low} to {kept_high} % of what their ensemble predicts. With the paper's "
            "throws much depends on the data set: at 9 m *Ê* retains {papers_first} % of *E* with the first and "
            "{papers_second} % with the second, and *Ê\\** {designed_first} % and {designed_second} %.",
            (DESK,),
            figures.over_depths,
            figures.always_ahead,
        ),
        Sentence(
            "Zero-shot it is met at {zero_shot} of the ten depths, 9 m among them, and missed most at "
            "{zero_shot_where} m, where *Ê\\** retains {zero_shot_least} %; adapted, it is met at {adapted} depths and "
            "missed most at {adapted_where} m, with {adapted_least} %.",
            (DESK,),
            figures.aims,
            figures.aim_is_met_at_9m,
        ),
        Sentence(
            "([how many are needed](#trials-and-replicates)). {same} of the paper's {all} t tests come out as the "
            "paper claims, {other} otherwise, and {untold} are undecided, judged together by Holm's procedure.",
            (DESK,),
            figures.t_tests,
        ),
        Sentence(
            "Champions evolved in true slush at 9 m travel {ours} m here",
            (ROW,),
            lambda row: {"ours": figures.spread(row, "true_slush", "zero_shot")},
        ),
        Sentence(
            "Variation operators alone move *E* from {low} to {high} m with the same physics. If a changed gene is "
            "resampled uniformly, *E* travels {redrawn} m over {n} trials: less than with our default (Welch's test, "
            "p < 0.001), and a repetition with the paper's 10 trials would give {least} to {most} m, which includes "
            "its 13.6 m.",
            (CHOICES,),
            figures.variation,
            figures.variation_holds,
        ),
        Sentence("none accounts for more than about {most} m of the {gap} m.", (CHOICES,), figures.small_effects),
        Sentence("displacement is a root that swings forwards (CoM {low} and {high} m)", (CHOICES,), figures.reach),
        Sentence("(ours travel {ours} m)", (ROW,), lambda row: {"ours": figures.spread(row, "dry_land", "predicted")}),
        Sentence(
            "with {n} trials of each, joint limits and motors that start after settling are negligible, and again a "
            "peak-to-peak range and tournaments matter.",
            (SENSITIVITY,),
            lambda sensitivity: {"n": f"{sensitivity['n_trials']}"},
            figures.sensitivity_holds,
        ),
        Sentence(
            "38 trials are too few to judge slower motors or resampled genes, which reduce *E* by {redrawn_there} m "
            "there, against {redrawn_here} m here; and steps of 0.5 add {longer_there} m there, where they take "
            "{longer_here} m off here.",
            (SENSITIVITY, CHOICES),
            figures.mutation_at_two_scales,
            lambda sensitivity, _: figures.spans_the_bound(sensitivity, "redraw"),
        ),
        Sentence(
            "At 1 and 3 m the ensemble's robots travel as far as its μ − σ. At 0.5 m they travel {ensemble} % of the "
            "prediction, because one of three falls short. A single member's robots travel {at_half} % of the "
            "prediction at 0.5 m, {at_one} % at 1 m and {at_three} % at 3 m.",
            (SHALLOW,),
            lambda shallow: {
                name: percent(kept(shallow, environment, depth))
                for name, environment, depth in (
                    ("ensemble", "residual_slush", 0.5),
                    ("at_half", "single_member", 0.5),
                    ("at_one", "single_member", 1),
                    ("at_three", "single_member", 3),
                )
            },
            lambda shallow: all(abs(kept(shallow, "residual_slush", depth) - 1) < EQUAL for depth in (1, 3)),
        ),
        Sentence(
            "In slush the order of the zero-shot means is the paper's. At 9 m *Ê* retains {zero_shot} % of *E* "
            "zero-shot and {adapted} % adapted, where the paper has 67 % and 87 %; the mean of *Ê\\** is ahead of it "
            "zero-shot at {ahead} of the {depths} depths, beyond chance (p < 0.05, Welch's t test) at {beyond} of "
            "them.",
            (LAPTOP,),
            lambda laptop: {
                **{
                    quantity: percent(share(laptop, "residual_slush", quantity))
                    for quantity in ("zero_shot", "adapted")
                },
                **figures.ahead(laptop),
            },
            figures.papers_order_holds,
        ),
        Sentence(
            "By data set, *Ê* retains {papers_0}, {papers_1}, {papers_2}, {papers_3} and {papers_4} % of *E* "
            "zero-shot, and *Ê\\** {designed_0}, {designed_1}, {designed_2}, {designed_3} and {designed_4} %. The "
            "first data set is that of `make study`: for the paper's throws it is the luckiest of the five.",
            (REPLICATES,),
            figures.shares_of_five,
            figures.first_is_luckiest,
        ),
        Sentence(
            "Robots of designed throws travel {papers} m farther than those of the paper's throws ({papers_low} to "
            "{papers_high} m; Welch's 95 % intervals, which include the variance between data sets), and {best} m "
            "farther than *E* ({best_low} to {best_high} m) and {randomised} m farther than those of the baseline "
            "({randomised_low} to {randomised_high} m), which ten trials cannot tell from no difference.",
            (REPLICATES,),
            figures.differences,
            figures.differences_hold,
        ),
        Sentence(
            "With designed throws the same networks predict what robots do:",
            (LAPTOP,),
            holds=figures.designed_throws_hold,
        ),
        Sentence(
            "{same} of the paper's {all} t tests come out as the paper claims, {other} otherwise, and {untold} are "
            "undecided, judged together by Holm's procedure. Among the undecided is the paper's claim that robots of "
            "Residual Slush, zero-shot, go farther than adapted ones of Dry Land at 9 m.",
            (LAPTOP,),
            figures.t_tests,
            figures.key_claim_is_undecided,
        ),
        _recorded(
            "all throws and networks have the same digests, and all figures of {champions} champions are the same",
            "desk_again",
        ),
        Sentence(
            "By data set, *Ê* keeps {papers_0}, {papers_1}, {papers_2}, {papers_3} and {papers_4} % of *E* "
            "zero-shot, and *Ê\\** {designed_0}, {designed_1}, {designed_2}, {designed_3} and {designed_4} %. So "
            "robots of designed throws travel {papers} m farther than those of the paper's ({papers_low} to "
            "{papers_high} m), {randomised} m farther than those of randomised slush ({randomised_low} to "
            "{randomised_high} m), and cannot be told from *E* (difference {best} m, {best_low} to {best_high} m);",
            (DESK_REPLICATES,),
            lambda replicates: {**figures.shares_of_five(replicates), **figures.differences(replicates)},
            figures.ahead_of_all_but_the_best,
        ),
        Sentence(
            "{exploiters} of 10 robots of *Ê* exploit their ensemble, and none of *Ê\\**. A single network of "
            "designed throws keeps {single} %.",
            (DESK_REPLICATES,),
            lambda replicates: {
                "exploiters": f"{figures.n_exploiters(replicates, 'residual_slush')}",
                "single": percent(share(replicates, "designed_single_member")),
            },
            lambda replicates: figures.n_exploiters(replicates, "designed_throws") == 0,
        ),
        Sentence(
            "At 9 m `desk-replicates` has {n} trials in common with it:",
            (DESK, DESK_REPLICATES),
            lambda desk, replicates: {"n": f"{figures.n_repeated(desk, replicates)}"},
        ),
        _recorded(
            "The processor times of the study's items are those of {all} hours on two cores, and for the paper's three "
            "environments alone, with designed throws for the learned one, of {three} hours.",
            "desk_time",
        ),
        _recorded("*Ê* travelled {one} m and {other} m zero-shot at 9 m.", "two_machines"),
        Sentence(
            "where it ends between {behind} cm behind its start and {ahead} cm ahead of it. Of the {n} champions, "
            "{filled} cross the filled tank in every trial and the dry floor in none, {immobile} of them without "
            "leaving their place; {both} cross both in at least one trial. If the simulation's frequencies are kept, "
            "{filled_kept} trials cross the filled tank and {dry_kept} the dry floor.",
            (ROBOT,),
            lambda robot: {
                "behind": f"{-robot['proposed']['ends_on_the_dry_floor_cm'][0]}",
                "ahead": f"{robot['proposed']['ends_on_the_dry_floor_cm'][1]}",
                "n": f"{robot['champions']['n']}",
                "filled": f"{robot['champions']['filled_always_and_dry_never']}",
                "immobile": f"{robot['champions']['of_these_immobile']}",
                "both": f"{robot['champions']['both_at_least_once']}",
                "filled_kept": f"{robot['at_kept_frequencies']['filled']}",
                "dry_kept": f"{robot['at_kept_frequencies']['dry']}",
            },
        ),
        Sentence(
            "Champions are predicted to travel {predicted} m and travel {true} m in 2 m of true slush. Of the 16, "
            "{held} travel at least {least} % of their prediction, and one exploits its networks: it is predicted "
            "to travel {worst_predicted} m, and travels {worst_true} m. Neither σ nor coverage would have told it "
            "apart: its networks agree more than those of any other (σ is {sigma} m, the others' {sigma_least} to "
            "{sigma_most} m), and no more of what it does lies outside the throws than of what the others do "
            "({outside} %, theirs {outside_least} to {outside_most} %). Of the 16, {crossing} cross the filled tank in "
            "every trial, and {as_papers} of these the dry floor in none, as the paper's robot. With the torque of a "
            "servo, the dry floor is crossed in {servo} of 128 trials.",
            (PONTOON,),
            figures.robots_to_build,
            figures.one_exploits,
        ),
        Sentence(
            "with {height} cm it is higher than the walls of the tank, which is open at the top; {fit} of the 16 fit. "
            "With a draught of {draught} cm it stands on the floor of the tank, which is filled 15 cm deep. Its "
            "[kit](bench-robot.md#fabricate-it) has {faults} faults and {warnings} warnings. Its servos give "
            "{margin_1} and {margin_2} times the torque that the simulated motors give; these were at their limit of "
            "30 N·m in {limited_least} and {limited_most} % of the run, so a servo may have to give more. The study "
            "took {core_hours} core-hours, {hours} hours on two cores.",
            (PONTOON,),
            figures.robots_to_build,
        ),
        Sentence(
            "Settled, {higher} of the {n} are higher than its walls of 270 mm, filled or drained, and so is the "
            "proposed one, which stands {height} cm high in the filled tank.",
            (ROBOT,),
            lambda robot: {
                "higher": f"{robot['champions']['higher_than_the_tank']}",
                "n": f"{robot['champions']['n']}",
                "height": f"{robot['proposed']['height_in_the_filled_tank_cm']}",
            },
        ),
        Sentence(
            "{share} % of the samples show no variance between them",
            (INTERVALS,),
            lambda intervals: {"share": percent(intervals["two_without_variance_between"])},
        ),
    ),
    "docs/throws.md": (
        _recorded("links of robots move at {slow} to {fast} m/s, turn at less than {spin} rad/s", "links"),
        Sentence(
            "The paper's throws leave errors nearly as large as the residual itself. Designed throws leave a quarter, "
            "with as many transitions, and hardly more with a fifth of them.",
            (THROWS,),
            holds=of_throws.errors_hold,
        ),
        Sentence(
            "Magnitudes as further inputs (|v|, |ω|, |sin θ|; `network.observation`) leave {magnitudes} % of the error "
            "of 2 × 32 with six inputs, 2 × 48 leaves {wider} %, and 3 × 64 {deeper} %, for 6.7 times as many "
            "multiplications:",
            (THROWS,),
            of_throws.larger_networks,
        ),
        Sentence(
            "Robots evolved with designed throws travel as far as the ensemble predicts. Over [five data "
            "sets](results.md#five-data-sets) they travel {papers} m farther than those of the paper's throws "
            "({papers_low} to {papers_high} m). With a single network they keep {designed} % of *E*. With the paper's "
            "throws the ensemble makes the difference: there a single network's robots keep {single} %.",
            (LAPTOP, REPLICATES),
            lambda laptop, replicates: {
                **figures.differences(replicates),
                "designed": percent(share(laptop, "designed_single_member")),
                "single": percent(share(laptop, "single_member")),
            },
            lambda laptop, replicates: (
                figures.designed_throws_hold(laptop)
                and figures.differences_hold(replicates)
                and share(laptop, "single_member") < share(laptop, "residual_slush") / 2
            ),
        ),
        Sentence(
            "With networks that observe magnitudes, robots of the paper's throws travel {less} m less far zero-shot "
            "(p = {p_less}), and those of designed throws {farther} m farther (p = {p_farther}). By Welch's t test "
            "neither differs from chance in ten trials each:",
            (LAPTOP, MAGNITUDES),
            figures.magnitudes,
            lambda *studies: all(float(figures.magnitudes(*studies)[name]) > 0.05 for name in ("p_less", "p_farther")),
        ),
        Sentence(
            "In these studies no k and no number of members lets robots of the paper's throws keep a third of *E* on "
            "average. A larger k brings the prediction closer to the truth, but only because predictions fall, not "
            "because robots travel farther.",
            (STUDIES,),
            holds=of_throws.throws_matter_most,
        ),
        Sentence(
            "With designed throws a single network's robots go about as far as an ensemble's at this scale.",
            (STUDIES,),
            holds=of_throws.single_networks_suffice,
        ),
        Sentence(
            "at 9 m robots of a single network keep {single} % of *E*, those of four {ensemble} % (p = {p}), and "
            "{exploiters} of 10 exploit the single network, none the ensemble.",
            (DESK,),
            of_throws.ensembles_matter,
            lambda desk: figures.n_exploiters(desk, "designed_throws") == 0,
        ),
        Sentence(
            "[Over five data sets](results.md#five-data-sets-at-9-m) a single network keeps {single} %, four "
            "{ensemble} %, and none is exploited.",
            (DESK_REPLICATES,),
            lambda replicates: {
                "single": percent(share(replicates, "designed_single_member")),
                "ensemble": percent(share(replicates, "designed_throws")),
            },
            lambda replicates: (
                figures.n_exploiters(replicates, "designed_single_member") == 0
                and figures.n_exploiters(replicates, "designed_throws") == 0
            ),
        ),
        Sentence(
            "No rule differs from μ − σ beyond chance: by Welch's t test p = {quartile} for the lower quartile with "
            "the paper's throws, and p = {calibrated} for the calibrated k with designed throws.",
            (RULES,),
            of_throws.p_of_rules,
            of_throws.no_rule_differs,
        ),
        Sentence(
            "With designed throws even μ alone loses little; with the paper's throws its robots exploit the ensemble "
            "in most trials.",
            (RULES,),
            holds=of_throws.designed_throws_need_no_penalty,
        ),
        Sentence(
            "100 designed throws leave {designed} % of *E* zero-shot and {designed_adapted} % adapted, where 100 of "
            "the paper's leave {papers} % and {papers_adapted} %. With nine inputs it is {nine} %, which six trials "
            "cannot tell from the six inputs' share. 90 % was the aim.",
            (FEW,),
            of_throws.from_100_throws,
            of_throws.below_the_aim,
        ),
        _recorded(
            "over four other sets of the paper's throws, three members keep {three} % and four keep {four} %", "members"
        ),
        _recorded(
            "{papers} % of the states of robots evolved in 9 m of *E* are outside the paper's throws, and {designed} % "
            "outside the designed ones; at 2 m, {papers_2m} % and {designed_2m} %. If the designed throws had "
            "no spins above 1 rad/s, {slow} % of the states would be outside at 9 m ({slow_2m} % at 2 m), most of them "
            "because of their spin ({spin} % and {spin_2m} % of all states).",
            "states_outside",
        ),
    ),
    "docs/your-own-tank.md": (
        Sentence(
            "Tracks at 60 frames a second without noise give {exact} % of what exact states give, and those of the "
            "synthetic video {video} %. The intervals show no loss, and rule out one of a quarter",
            (ROLLOUTS,),
            of_throws.shares_of_exact_states,
            of_throws.no_loss_of_a_quarter,
        ),
        Sentence(
            "With 0.3 mm of noise it is {noisy} %, with 1 mm {noisier} %, and with 250 throws in place of 500 "
            "{fewer} %; none of these differs from exact states beyond chance. 2 mm of noise leave {noisiest} "
            "%, and 100 throws {fewest} %, which do.",
            (ROLLOUTS,),
            of_throws.shares_of_fewer_and_noisier,
            of_throws.only_extremes_differ,
        ),
        Sentence(
            "500 throws tracked at 60 frames a second with up to 1 mm of noise lose a quarter of what exact states "
            "give, and so do those of the synthetic video. 2 mm of noise, or 100 throws in place of 500, lose more "
            "than half.",
            (TRACKS,),
            holds=of_throws.tracks_hold,
        ),
    ),
    "docs/filming.md": (
        Sentence(
            "Positions are off by a quarter of a millimetre, most of it constant", (VIDEO,), holds=of_throws.video_holds
        ),
        Sentence(
            "The stated uncertainty, which knows of noise only, is right within a fifth below 0.6 m/s with a "
            "board. For fast bars it is {board} % too small, and {share} % without a board.",
            (VIDEO,),
            of_throws.too_small,
            of_throws.slow_bars_hold,
        ),
        _recorded(
            "Filmed so for 12 s, the robot of `docs/design-buildable.json` was found to go at {same} mm/s, and with "
            "`--slower 0.5` at {slower} mm/s; in its simulation it goes at {simulated} mm/s. Its joints swing by "
            "{joint_2}° and {joint_5}°, in the simulation by {simulated_2}° and {simulated_5}°.",
            "filmed_run",
        ),
    ),
    "docs/bench-robot.md": (
        _recorded(
            "its three champions were predicted to travel {predicted_1}, {predicted_2} and {predicted_3} m and "
            "travelled {true_1}, {true_2} and {true_3} m in 2 m of true slush. The proposed one, the first, crosses "
            "the tank in {seconds} s of simulation, {bench_seconds} s on the bench, {speed} mm/s; on the tank's dry "
            "floor it advances {advanced} of {of} cm in 150 s.",
            "raft",
        ),
        _recorded(
            "It travels {metres} m in {seconds} s in 2 m of true slush, which is {bench_cm} cm in {bench_seconds} s on "
            "the bench",
            "buildable",
        ),
        Sentence(
            "champions were predicted to travel {predicted} m and travelled {true} m",
            (PONTOON,),
            figures.robots_to_build,
        ),
        Sentence(
            "The proposed one crosses the filled tank in {wet} of 8 trials and the dry floor in {dry}, where it ends "
            "within 5 cm of its start in {still}. Its kit has {faults} faults and {warnings} warnings, and its servos "
            "give {margin_1} and {margin_2} times the torque that the simulated motors give.",
            (PONTOON,),
            figures.robots_to_build,
        ),
        _recorded("its two servos give {margin_1} and {margin_2} times what the run needs.", "raft"),
        _recorded(
            "under the paper's rules alone parts collide during the gait in {papers} of 100 random designs, under the "
            "preset's in {presets}",
            "kits_of_random_designs",
        ),
    ),
    "docs/performance.md": (
        _recorded("on two idle cores the first `smoke` takes {fresh} s, and every later one {warm} s.", "first_run"),
        Sentence("Inference runs at {low} to {high} % of the core's peak", (PROFILE,), of_throws.shares_of_peak),
        Sentence(
            "With four networks of 2 × 32 a generation takes {least} times as long as in true slush, with four of 3 × "
            "64 {most} times",
            (PROFILE,),
            of_throws.times_of_true_slush,
        ),
        Sentence(
            "AFPO's own work is to ask, tell, pack designs into lanes and record what happened: {low} to {high} % of a "
            "generation in environments without networks, most where a generation is cheapest, in true slush at 9 m. "
            "The Parquet tables that record it add {low_tables} to {high_tables} %.",
            (BENCHMARKS,),
            of_throws.own_work,
        ),
    ),
}
