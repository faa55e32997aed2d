"""`vapor-benchmark buildings`: synthetic buildings, each with a model of its own, trained and used as the README says."""
