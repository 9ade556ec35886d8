"""Port-Hamiltonian models of piezoelectric actuators, and what they leave out."""
