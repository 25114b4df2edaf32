"""Results → pictures and pages."""
