"""The survey file: its sections, how it is read, and how mistakes in it are told.

``survey.py`` composes the chapters' parameters into one frozen :class:`~vtrack_batch.config.survey.Survey`;
``load.py`` reads YAML 1.2 and reports every mistake at once with line, column and a suggestion;
``example.py`` writes the commented example from the same definitions, so that it cannot drift.
"""
