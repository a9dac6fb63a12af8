"""Pictures of a plan: shaded views of the part, maps, and charts over time. A leaf for report and show."""
