"""Importing: what people have (exports, spreadsheets, recordings) proposed as measurements, with reasons."""
