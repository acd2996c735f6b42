"""The application: pipeline, configuration, runs, reports and the command line."""
