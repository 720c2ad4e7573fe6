def unit_findings(experiment):
    return []
