"""What a run leaves behind: record, report, pictures, a recording for the Rerun viewer."""
