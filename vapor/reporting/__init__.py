"""Results of a run: record, report, a recording for the Rerun viewer."""
