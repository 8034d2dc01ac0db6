"""The files that stages write and later ones read, and where they are among the inputs of an item or in a store."""

from pipeline.store.tables import TableFile

TRANSITIONS = TableFile("transitions")  # collect
WEIGHTS, LEARNING, ERRORS = "weights.safetensors", TableFile("learning"), TableFile("errors")  # train
POPULATION, HISTORY, CURVE = "population.safetensors", TableFile("history"), TableFile("curve")  # evolve and adapt
SCORE, CHAMPION, ADAPTED = "score.json", "champion.json", "adapted.json"  # transfer
PREDICTIONS = TableFile("predictions")  # assess
