"""A classifier of what the base model leaves, trained on the generator of the concealed actuators itself.

    drawn → simulated → base model fitted → features → table → classifier → probabilities

The table of features is what training leaves on the disk; the classifier is fitted from it in seconds. It knows the
generator: the laws, the ranges of their parameters, the recordings, the shares of the groups, and the effects that the
catalogue does not list. A tool for real recordings has none of this.
"""
