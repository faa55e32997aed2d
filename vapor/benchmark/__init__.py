"""Many runs over synthetic and real recordings, with and without faults; how long a step takes."""
