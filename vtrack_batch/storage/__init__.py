"""The rim: the only chapter that writes results to disk.

``parquet.py`` turns declared tables into Parquet and back; ``output.py`` knows the layout of a result folder, commits
finished parts and publishes snapshots; ``hashes.py`` remembers the content hashes of the archive's files;
``geotiff.py`` reads and writes georeferenced rasters; ``results.py`` opens a published snapshot for readers.

A file is whole or absent: everything is staged under ``state/staging``, made durable and renamed into place once.
"""
