"""Nouns that chapters share: tables, parameters, homographies, views, zones, ids, flags. They know nothing of files."""
