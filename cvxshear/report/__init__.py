"""Present results: terminal tables, figures, HTML reports and files for other programs."""
