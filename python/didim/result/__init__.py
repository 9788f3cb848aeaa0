"""The result of an identification: record, verdict, tables and sentences."""
