"""The command line `kinpole`, and the tools that it runs: pictures, reports, analysis, demo."""
