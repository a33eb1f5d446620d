"""Which frames are there, when were they taken, and what do they show?

The archive is a directory tree of image files that this program never writes to and never trusts. This is the only
chapter that reads it.

In     a root directory, ``ArchiveParams``, and, for frames seen before, what was known of them.
Out    ``Scan.files``, one row per frame with a known time; ``Scan.quarantine``, one row per file that cannot be used,
       with a reason; pixels, frame by frame.

Steps
    walk        regular files by the bytes of their paths; links are not followed     ``walk``
    time        what the file name, an index CSV or EXIF says                         ``times``
    zone        wall clock to UTC; both nights of summer time have stated rules       ``clock``
    scan        the three above, put together                                         ``scan``
    duplicates  one frame per platform and instant, decided by content hash           ``sequences``
    sequences   unbroken runs of one platform, split at gaps and local midnight       ``sequences``
    read        bytes of one file, opened safely and checked not to change meanwhile  ``read``
    header      format, size and samples, before any decoder sees the bytes           ``headers``
    decode      bytes to (H, W, 3) uint8 RGB, whole or not at all                     ``decode``
    fields      interlaced frames told by their comb; one field of two                ``fields``

What may go wrong with one frame is an ``errors.UnusableFrame`` or a row of ``Scan.quarantine``, never the end of a run;
what is wrong with the whole archive is ``errors.NoArchive`` (missing, empty) or ``errors.ConfigError`` (no name fits).

Assumptions: file contents do not change after they were written; stamps of one platform come from one clock. Never
assumed: a time zone (a stamp without one needs ``archive.time_zone``), an order of listing, names in UTF-8, honest
file extensions, complete files.

Sources: truncated JPEGs decode to grey halves in most decoders, damaged TIFFs to noise; therefore JPEG by libjpeg-turbo
stopping at its first warning, PNG by libpng with checksums, TIFF by GDAL's GTiff driver alone.

Cost: a scan about 30 us per file; decoding per megapixel 4-6 ms JPEG, 20-30 ms PNG, 1-15 ms TIFF.
"""
