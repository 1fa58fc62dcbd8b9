"""Statistics of experiments, as functions of numbers, independent of studies and files.

proportions          percent correct, Wilson intervals, exact tests against chance
psychometric_shapes  logistic, Weibull and cumulative normal functions
likelihood_search    many psychometric functions fitted at once
psychometric         one psychometric function with bootstrap intervals: threshold, PSE, JND, Weber fraction
confusion            confusion matrices and information transfer
bradley_terry        a scale from paired comparisons, with ties
motor                paired comparison of measures of a motion
order_matrices       percent correct of each pair, as in tables of paired comparisons
participants         medians and quartiles over participants, ranks
"""
