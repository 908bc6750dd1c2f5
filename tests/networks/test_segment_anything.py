"""A small Segment Anything: its input, its prompts, and the guess that is taken."""

import numpy as np
import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.networks.segment_anything import MaskGuess, Prompt, SegmentAnything
from gva_mi.subject.crop import CropBox, bounds

transformers = pytest.importorskip("transformers")


@pytest.fixture
def tiny_sam(tmp_path, one_thread):
    """Segment Anything of 64 x 64 pixels, with numbers drawn at random."""
    torch.manual_seed(0)
    vision = transformers.SamVisionConfig(
        hidden_size=32, num_hidden_layers=1, num_attention_heads=2, image_size=64, patch_size=4,
        window_size=0, global_attn_indexes=[0], output_channels=32, mlp_ratio=2.0, num_pos_feats=16,
    )  # fmt: skip
    prompts = transformers.SamPromptEncoderConfig(
        hidden_size=32, image_size=64, patch_size=4, mask_input_channels=4
    )
    masks = transformers.SamMaskDecoderConfig(hidden_size=32, num_hidden_layers=1,
        num_attention_heads=2, mlp_dim=32, iou_head_hidden_dim=16)  # fmt: skip
    transformers.SamModel(transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=masks
    )).save_pretrained(tmp_path)  # fmt: skip
    return tmp_path


def ellipse(size, centre, radii):
    """A picture (H, W, 3) of a bright ellipse, and where it is."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[: size[1], : size[0]] + 0.5
    inside = ((x - centre[0]) / radii[0]) ** 2 + ((y - centre[1]) / radii[1]) ** 2 < 1
    image = random.integers(60, 90, (size[1], size[0], 3)).astype(np.uint8)
    image[inside] = (230, 215, 240)
    return image, inside


def prompt(inside, points):
    return Prompt(bounds(inside), np.array(points, float), np.ones(len(points), int))


def test_inputs_equal_those_of_the_processor_of_transformers(tiny_sam):
    """A crop that is the picture itself: the network's own preparation gives the same guesses."""
    image, inside = ellipse((64, 64), (30, 33), (12, 20))
    points, box = np.array([[30.0, 33.0], [28.0, 25.0]]), bounds(inside)
    sam = SegmentAnything.load(tiny_sam)
    told = Prompt(box, points, np.array([1, 1]))
    size = {"longest_edge": 64}, {"height": 64, "width": 64}
    processor = transformers.SamProcessor(
        transformers.models.sam.image_processing_pil_sam.SamImageProcessorPil(
            size=size[0], pad_size=size[1]
        )
    )
    given = processor(image, input_points=[[(points - 0.5).tolist()]], input_labels=[[[1, 1]]],
        input_boxes=[[(box - 0.5).tolist()]], return_tensors="pt")  # fmt: skip
    with torch.no_grad():
        wanted = sam.network(**{k: given[k].float() if given[k].is_floating_point() else given[k]
                                for k in ("pixel_values", "input_points", "input_labels",
                                          "input_boxes")})  # fmt: skip
        crop = CropBox(0, 0, 64, 64)
        seen = torch.from_numpy(crop.resized(image, sam.size, (0, 0, 0)).astype(np.float32) / 255)
        mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
        seen = ((seen - mean) / std).permute(2, 0, 1)[None]
        logits, scores = sam._guess(sam.network.get_image_embeddings(seen), crop, told, None)
    assert torch.allclose(seen, given["pixel_values"], atol=1e-5)
    assert torch.allclose(logits, wanted.pred_masks[0, 0], atol=1e-3)
    assert torch.allclose(scores, wanted.iou_scores[0, 0], atol=1e-4)


class Guesses(SegmentAnything):
    """Guesses that a test gives, in the place of the network's."""

    def __init__(self, alone, after=None):
        self.size, self.given, self.network = (32, 32), (alone, after), self

    def get_image_embeddings(self, seen):
        assert seen.shape == (1, 3, 32, 32)

    def _guess(self, embeddings, crop, prompt, last):
        masks, scores = zip(*self.given[last is not None], strict=True)
        return torch.stack(masks), torch.tensor(scores)


def drawn(left, top, right, bottom):
    """Logits (32, 32) of a rectangle, in shares of the crop."""
    y, x = np.mgrid[:32, :32] / 32
    inside = (x >= left) & (x < right) & (y >= top) & (y < bottom)
    return torch.from_numpy(np.where(inside, 5.0, -5.0).astype(np.float32))


IMAGE = np.zeros((100, 100, 3), np.uint8)


def test_the_guess_that_holds_the_points_and_stays_in_the_box_is_taken():
    sleeve, person = drawn(0.4, 0.2, 0.6, 0.4), drawn(0.2, 0.2, 0.8, 0.8)
    all_of_it = drawn(0, 0, 1, 1)
    guesses = Guesses([(sleeve, 0.95), (person, 0.9), (all_of_it, 0.92)])
    box = np.array([20.0, 20.0, 80.0, 80.0])
    told = Prompt(box, np.array([[50.0, 30.0], [50.0, 70.0], [30.0, 60.0]]), np.ones(3, int))
    found = guesses.find(IMAGE, told)
    assert torch.equal(found.logits, person)
    others = Prompt(box, np.array([[50.0, 30.0], [30.0, 60.0]]), np.array([1, 0]))
    assert torch.equal(guesses.find(IMAGE, others).logits, sleeve)  # that point is somebody else
    last = MaskGuess(found.mask, found.crop, sleeve)
    after = Guesses([(person, 0.9), (all_of_it, 0.9)], [(sleeve, 0.99)])
    upper = Prompt(box, np.array([[50.0, 30.0]]), np.ones(1, int))
    assert torch.equal(after.find(IMAGE, upper, last).logits, sleeve)  # as in the frame before


@pytest.mark.parametrize("left", [20, -30])
def test_the_mask_lies_in_the_picture_where_the_crop_does(left):
    """Also of a crop that crosses the border."""
    box = np.array([left, 20.0, left + 60, 80.0])
    told = Prompt(box, np.array([[left + 40.0, 30.0]]), np.ones(1, int))
    found = Guesses([(drawn(0.25, 0.25, 0.75, 0.5), 0.9)]).find(IMAGE, told)
    side, corner = 78, (11, left - 9)  # a margin of 0.15 on each side
    low, high = (np.round(corner + np.array(at) * side) for at in ((0.25, 0.25), (0.5, 0.75)))
    wanted = np.zeros((100, 100), bool)
    wanted[int(low[0]) : int(high[0]), max(0, int(low[1])) : int(high[1])] = True
    assert found.mask.shape == (100, 100)
    assert (found.mask & wanted).sum() / (found.mask | wanted).sum() > 0.9


BAD = {  # the files of a checkpoint, and the sentence
    "nothing": ({}, "config.json: no such file"),
    "another network": ({"config.json": '{"model_type": "bert"}'}, "a network of the kind bert"),
    "no weights": ({"config.json": '{"model_type": "sam"}'}, "cannot be read"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_checkpoint_is_refused_in_one_sentence(name, tmp_path):
    files, words = BAD[name]
    for file, text in files.items():
        (tmp_path / file).write_text(text)
    with pytest.raises(InputError, match=words) as error:
        SegmentAnything.load(tmp_path)
    assert "facebook/sam-vit-base" in str(error.value)


def test_sam_2_answers_in_the_same_form(tmp_path):
    backbone = transformers.Sam2HieraDetConfig(
        hidden_size=8, num_attention_heads=1, image_size=[64, 64], blocks_per_stage=[1, 2, 1, 1],
        embed_dim_per_stage=[8, 16, 32, 64], num_attention_heads_per_stage=[1, 1, 1, 1],
        global_attention_blocks=[2], window_positional_embedding_background_size=[4, 4],
    )  # fmt: skip
    vision = transformers.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=16,
        backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]],
    )  # fmt: skip
    prompts = transformers.Sam2PromptEncoderConfig(
        hidden_size=16, image_size=64, patch_size=16, mask_input_channels=4
    )
    masks = transformers.Sam2MaskDecoderConfig(hidden_size=16, num_hidden_layers=1,
        num_attention_heads=2, mlp_dim=32, iou_head_hidden_dim=16)  # fmt: skip
    transformers.Sam2Model(transformers.Sam2Config(
        vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=masks
    )).save_pretrained(tmp_path / "sam2")  # fmt: skip
    sam = SegmentAnything.load(tmp_path / "sam2")
    image, inside = ellipse((90, 70), (40, 30), (12, 20))
    found = sam.find(image, prompt(inside, [(40, 30)]))
    again = sam.find(image, prompt(inside, [(40, 30)]), found)
    assert found.mask.shape == again.mask.shape == (70, 90)
    assert torch.isfinite(again.logits).all()
