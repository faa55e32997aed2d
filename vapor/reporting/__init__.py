"""What a run leaves behind: record, report, a recording for the Rerun viewer."""
