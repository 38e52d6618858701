"""The record of results that report, plot, view and demo show, and where it is read from."""
