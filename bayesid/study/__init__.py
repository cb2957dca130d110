"""The machinery of studies: trials on many cores, their record, report and figure."""
