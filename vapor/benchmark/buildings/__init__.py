"""`vapor-benchmark buildings`: synthetic buildings, each with a model that is trained and used as the README says."""
