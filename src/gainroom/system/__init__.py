"""System description (plant, drives, controller, filters, requirements, uncertainty) and the feedback loop built from it."""
