"""What knows nothing of sheets: text, files, folders, records, safe maths."""
