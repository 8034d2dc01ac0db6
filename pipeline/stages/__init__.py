"""The stages of a study, in the order in which they run."""

from pipeline.stages import analyse, assess, collect, evolve, report, train, transfer

STAGES = (collect.STAGE, train.STAGE, evolve.STAGE, transfer.STAGE, assess.STAGE, analyse.STAGE, report.STAGE)
