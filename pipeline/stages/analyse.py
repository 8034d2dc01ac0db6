"""analyse: what the study shows, as tables. Paper, "Results", and what it leaves open: where the ensemble hallucinates.

Each chain is one item. Its tables are Parquet (schema = the file's name without suffix, version 1; read them with
:func:`read_table`). A number that is not there is NaN, a text is empty. An estimate X is four columns: X, X_low, X_high
(95 %) and X_reason (why X or its interval is missing). Beside its tables each item has ``reasons.json``: by table, why
it has no rows or lacks something; {} if all is there. Lengths in m unless said.

``statistics`` (pipeline/stages/statistics.py), from scores and predictions alone:
    scores.parquet        a row per trial: environment, depth, trial, predicted, zero_shot, zero_shot_com, zero_shot_reach
                          (root less centre of mass), adapted, adapted_com, adapted_reach, status ("ok", or why not)
    regressions.parquet   a row per predictor ("member 0", "mean", "mean - 1 sd", "min", ...): name, n, n_left_out, and the
                          estimates slope, intercept [m], r
    histograms.parquet    a row per member, mean and mean - 1 sd: name, n_outside, edges (n_bins + 1 numbers, both axes),
                          counts (n_bins² numbers: reshape to predicted by true)
    contrasts.parquet     a row per contrast and depth: a, b ("dry_land/adapted"), depth, then of each side X = a, b: X_n,
                          X_n_left_out, the estimate X_mean, X_sd; of each test T = student, welch, mann_whitney:
                          T_statistic, T_p, T_reason; the estimates hedges_g and ratio; T_holm (p over the depths)
    attribution.parquet   a row per arm and depth: evolved_in, depth, n, n_best, and the estimates predicted, zero_shot,
                          adapted, best, imagined, gap, lost_to_controller, lost_to_body, controller_share, body_share,
                          recovered_zero_shot, recovered_adapted, recovered_of_dry_land
    paper.parquet         a row per number of the paper: what, paper, source, this_run, verdict ("agrees", "differs", "not
                          comparable"), why, value
``members``, from networks and throws:
    phantom_thrust.parquet   a row per member: member, the estimate thrust [m/s²] (needs no True Slush)
    member_errors.parquet    on the throws held out, a row per member, component, band and immersion: member, component,
                             band, immersion, n_rows, bias, rmse, rms_true [m/s², m/s², rad/s²]
``transfer-matrix``, champions of every trial tested at every depth in True Slush:
    tests.parquet         environment, trained, trial, tested, displacement, com_displacement
    matrix.parquet        environment, trained, tested, mean, sd, n, relative (to the champions at home there)
``exploiters``, every champion and every assessed design, the worst first:
    exploiters.parquet    rank, kind ("champion", "assessed"), environment, depth, trial, generation and identity (-1 of a
                          champion), predicted (by the ensemble, or by the champion's own single member), true, excess,
                          disagreement (σ over members), ranked_by, reason, by_member (n_members numbers)
``instruments/<environment>/<depth>m``, the champions of one arm; links and worlds are of the best zero-shot champion,
the one that the page films:
    champions.parquet     a row per champion: trial, best, displacement and com_displacement and reach where it evolved (mean
                          over members), displacement_in_slush, com_displacement_in_slush, reach_in_slush; winner's luck:
                          claimed (fitness where it evolved), again (mean of its tries), the estimate loss, share_below,
                          n_diverged, n_tries
    links.parquet         a row per world, step and link, in that order: world ("true_slush"; then where it evolved, if that
                          is elsewhere), step, link, disagreement [m/s²], novelty (1 is usual), distance [deviations],
                          component (of OBSERVATION; "" unknown), departure and thrust (n_members numbers each, m/s²)
    worlds.parquet        a row per world in links: world, member (whose world it is, -1 for none: of an ensemble the member
                          that promises most), trial, displacement, disagreement (mean), share_novel (novelty above 1),
                          thrust (n_members numbers: mean departure along x)
    member_errors.parquet    as of ``members``, along the rollouts of all the arm's champions in True Slush
"""
