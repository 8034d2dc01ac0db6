"""The engine for articulated robots: Box2D's step of trees of links, one robot per lane."""
