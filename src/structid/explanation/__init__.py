"""Why a study does not explain its record: candidate changes refitted, ranked, and written as studies ready to run."""
