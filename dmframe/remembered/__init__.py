"""Verdicts of ``dmframe verify`` that are kept, and shown again while everything they were made from is the same."""
