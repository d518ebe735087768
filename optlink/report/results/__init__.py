"""Result files of simulations, balancing and studies, read strictly, as pages."""
