"""Diagnosis: what a fitted model still gets wrong, and why."""

FALSE_ALARM = 0.01  # the chance that anything is found where nothing is hidden, unless a study says otherwise
