"""Learning: the observation encoder, the policy, MAPPO, the curriculum and the trainer that runs and resumes them."""
