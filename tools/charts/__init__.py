"""What tools/chart.py draws: one module per chart, from a Report (report.py) to pictures or HTML."""
