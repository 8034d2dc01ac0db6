"""The stages of a study, in the order in which they run."""

from pipeline.stages.adapt import ADAPT
from pipeline.stages.analyse import ANALYSE
from pipeline.stages.assess import ASSESS
from pipeline.stages.collect import COLLECT
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.report import REPORT
from pipeline.stages.train import TRAIN
from pipeline.stages.transfer import TRANSFER
from pipeline.workflow.stage import AnyStage

STAGES: tuple[AnyStage, ...] = (COLLECT, TRAIN, EVOLVE, ADAPT, TRANSFER, ASSESS, ANALYSE, REPORT)
