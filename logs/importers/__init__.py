"""Importers: foreign log formats as ordered streams of messages."""
